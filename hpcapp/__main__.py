"""``python -m hpcapp`` is the command ``hpcapp``."""

from hpcapp.cli import main

if __name__ == "__main__":
    main()
