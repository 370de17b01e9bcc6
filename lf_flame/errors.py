"""The exception for input that cannot be used."""


class InputError(ValueError):
    """Input that cannot be used.

    The message is one sentence: what is wrong, the value, and what is allowed. The command line
    prints it without a traceback and exits with status 2.
    """
