"""Other programs' files into ours: boards, drawings, position files and recordings."""
