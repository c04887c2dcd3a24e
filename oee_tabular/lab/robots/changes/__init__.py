"""Changes that nobody tuned for: tasks with every parameter free, and what estimates are worth there."""
