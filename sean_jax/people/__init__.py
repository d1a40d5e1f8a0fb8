"""Who walks, and where to (section IV-D): behaviors, recordings, pedestrian models, density."""
