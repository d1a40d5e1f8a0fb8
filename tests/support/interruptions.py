"""What happens to a run in the middle."""

from sean_jax.runner import Runner


def at_second_batch(monkeypatch, what):
    """Do ``what`` with each batch from the second on, as soon as it is simulated."""
    run = Runner.run

    def disturbed(runner, seed, first, *others, **named):
        batch = run(runner, seed, first, *others, **named)
        return (what(batch) or batch) if first else batch

    monkeypatch.setattr(Runner, "run", disturbed)
