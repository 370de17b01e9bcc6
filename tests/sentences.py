"""What a call says of bad input, for tests over many of them."""

from lf_flame import InputError


def sentence_of(call, *arguments):
    """Give the sentence that a call ends in, or nothing where it takes what it is given."""
    try:
        call(*arguments)
    except InputError as error:
        return str(error)
    return ""
