"""The report of simulate: readings over the touch, its figures and tables."""
