"""What a walk keeps of its photons on their way."""
