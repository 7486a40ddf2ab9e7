"""Flights, demo, campaigns and the ``gtmr`` command line."""
