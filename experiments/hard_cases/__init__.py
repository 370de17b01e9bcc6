"""Cases in which the obvious formula fails, each beside the exact value and this package's."""
