"""The work of a batch, spread over processes and machines by Dask, which no other room knows."""
