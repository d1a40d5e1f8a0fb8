"""benchmarks/options.py: options have the kind of their defaults."""

from pathlib import Path

import pytest

from support.checkout import benchmark

options = benchmark("options")


def parse(*words: str):
    command = options.parser(
        "What it does.",
        people=62,
        batches=[1, 64],
        no_loop=False,
        only=options.Option([], "names of parts"),
        out=options.Option(kind=Path),
        dynamics=options.Option("twin", choices=("twin", "mjx")),
    )
    return command.parse_args(words)


def test_options_have_the_kind_of_their_defaults():
    usual = parse()
    assert vars(usual) == dict(people=62, batches=[1, 64], no_loop=False, only=[], out=None, dynamics="twin")
    chosen = parse(*"--people 3 --batches 2 4 --no-loop --only a b --out c/d --dynamics mjx".split())
    assert vars(chosen) == dict(
        people=3, batches=[2, 4], no_loop=True, only=["a", "b"], out=Path("c/d"), dynamics="mjx"
    )


@pytest.mark.parametrize("words", ["--people many", "--dynamics other", "--batches", "--speed 1"])
def test_wrong_words_are_refused(words, capsys):
    with pytest.raises(SystemExit):
        parse(*words.split())
    assert "error" in capsys.readouterr().err


def test_a_required_option_is_missed():
    command = options.parser(None, data=options.Option(None, "a folder", kind=Path, required=True))
    with pytest.raises(SystemExit):
        command.parse_args([])
