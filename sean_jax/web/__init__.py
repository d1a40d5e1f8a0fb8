"""Pages and their servers on this computer: replays, the live view, the studio."""
