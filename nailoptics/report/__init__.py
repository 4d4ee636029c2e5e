"""PICTURES AND WORDS: figures of a result, one self-contained page of them, its summary and its files."""
