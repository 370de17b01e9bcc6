"""The program, as ``python -m lf_flame``."""

from lf_flame.commands.cli import main

if __name__ == "__main__":
    main()
