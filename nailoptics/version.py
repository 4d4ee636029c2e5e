"""The version of this code; between releases it ends in .dev0."""

__version__ = "0.3.0.dev0"
