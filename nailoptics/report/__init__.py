"""PICTURES AND WORDS: figures of a result and one self-contained page of them."""

from .picture import readme_picture
from .simulate_page import write_report

__all__ = ["readme_picture", "write_report"]
