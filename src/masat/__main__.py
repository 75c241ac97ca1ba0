"""`python -m masat`."""

from masat.cli import main

if __name__ == "__main__":
    main()
