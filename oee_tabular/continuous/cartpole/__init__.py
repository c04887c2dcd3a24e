"""CartPole under another gravity (the paper's Section VI.B): its dynamics, and its expert."""
