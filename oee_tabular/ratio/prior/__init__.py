"""The prior of a row of the target: its centre (the simulator, tilts of it, their average), and how strongly it is believed."""
