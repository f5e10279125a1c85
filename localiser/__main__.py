"""`python -m localiser` and the command `localiser`."""

from localiser.cli import main

if __name__ == "__main__":
    main()
