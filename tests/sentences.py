"""What a call says of bad input, for tests over many of them."""

from functools import partial

import pytest

from lf_flame import InputError


def sentence_of(call, *arguments):
    """Give the sentence that a call ends in, or nothing where it takes what it is given."""
    try:
        call(*arguments)
    except InputError as error:
        return str(error)
    return ""


def each(call, *cases):
    """Pairs of a call with the arguments of each case (a tuple or a dict), and what it says."""
    return [
        (partial(call, **given) if isinstance(given, dict) else partial(call, *given), said)
        for given, said in cases
    ]


def refusals(pairs):
    """One test of pairs: a call without arguments, and part of the sentence that it ends in."""

    @pytest.mark.parametrize(
        ("call", "said"), pairs, ids=[f"{k}-{said[:30]}" for k, (_, said) in enumerate(pairs)]
    )
    def test(call, said, tmp_path, monkeypatch):
        monkeypatch.chdir(tmp_path)
        with pytest.raises(InputError, match=said) as refused:
            call()
        assert "\n" not in str(refused.value)
        assert str(refused.value).count("cannot be read") <= 1

    return test
