"""The colour of a nail and the skin around it under force."""
