"""`python -m kinedex` does what the console command `kinedex` does."""

from kinedex.commands.cli import main

if __name__ == "__main__":  # worker processes import this module where the system cannot fork
    main()
