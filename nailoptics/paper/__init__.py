"""THE PAPER AS PRINTED: its optics, the touches of its figures, and what it claims of them."""
