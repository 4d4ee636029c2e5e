"""Tables from which a page shows any layout at once."""
