"""QUESTIONS: a module or a package each, Dataset out."""
