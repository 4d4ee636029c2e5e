"""Finger and board for other programs."""
