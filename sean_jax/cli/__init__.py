"""The command line: its words, the check of a machine, and its benchmark."""
