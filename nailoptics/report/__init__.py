"""PICTURES AND WORDS: figures of a result and one self-contained page of them."""

from .page import write_report
from .picture import readme_picture

__all__ = ["readme_picture", "write_report"]
