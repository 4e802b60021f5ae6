"""The command texnet, and python -m texnet."""

import sys

from .loading import loading


def main():
    """Run one command; returns the exit code, 130 also for Ctrl-C while all else loads."""
    try:
        with loading():
            from . import cli
    except KeyboardInterrupt:
        print("texnet: interrupted", file=sys.stderr)
        return 130
    return cli.main()


if __name__ == "__main__":
    sys.exit(main())
