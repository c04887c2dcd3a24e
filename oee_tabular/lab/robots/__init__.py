"""The studies of CartPole, Reacher and Kinova, and of residuals under other changes (``changes``)."""
