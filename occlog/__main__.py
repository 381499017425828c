"""Entry point of the `occlog` command and of `python -m occlog`."""

from occlog.cli.main import main

if __name__ == "__main__":
    main()
