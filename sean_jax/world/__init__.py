"""The place (section IV-C): environments, shortest paths on their floors, imported maps, generated floors."""
