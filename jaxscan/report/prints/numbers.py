"""Numbers in drawings."""


def decimal(value: float) -> str:
    """A length to a ten-thousandth, without an exponent, which PDF does not know."""
    return f"{value:.4f}".rstrip("0").rstrip(".")
