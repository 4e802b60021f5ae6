"""The one exception that means: the input is wrong, and this is how to mend it."""


class InputError(ValueError):
    """Bad input, said in one sentence; the command line prints it and exits with code 2."""
