"""Cases in which the obvious formula fails, compared with the exact value and this package's."""
