"""QUESTIONS: one file each."""
