"""Files and folders: reading with bounds, writing whole results, caches, trajectories, progress and interrupts."""
