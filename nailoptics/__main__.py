"""`python -m nailoptics` is the command line."""

from .cli import main

main()
