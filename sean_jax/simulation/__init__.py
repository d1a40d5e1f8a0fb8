"""The step and everything that runs it (section IV-B): scenarios, teams, episodes, batches of episodes."""
