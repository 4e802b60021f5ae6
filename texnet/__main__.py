"""The command texnet, and python -m texnet."""

import sys

from .loading import loading


def main():
    """Run one command; returns the exit code, which is 130 also if Ctrl-C comes during loading."""
    try:
        with loading():
            from . import cli
    except KeyboardInterrupt:
        print("texnet: interrupted", file=sys.stderr)
        return 130
    return cli.main()


if __name__ == "__main__":
    sys.exit(main())
