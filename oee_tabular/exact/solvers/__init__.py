"""Solvers of a policy's linear system."""
