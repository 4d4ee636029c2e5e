"""What a simpler model of the light costs in error, and what it saves."""
