"""Pools that run networks: threads, executors, a Dask cluster."""
