"""A sweep in chunks of one size, computed ahead, gathered on one grid."""
