"""Exceptions for invalid input, whose message says how to mend it."""


class InputError(ValueError):
    """Bad input, said in one sentence; the command line prints it and exits with code 2."""


class Implausible(InputError):
    """Numbers that no scene has, be they read or what a correction would make of them."""
