"""PICTURES AND WORDS: figures of a result and one self-contained page of them."""

from .pages.simulate.page import write_report

__all__ = ["write_report"]
