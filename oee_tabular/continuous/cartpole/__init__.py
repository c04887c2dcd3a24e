"""CartPole under another gravity (the paper's Section VI.B)."""
