"""`python -m kinedex` does what the console command `kinedex` does."""

from kinedex.pipelines.commands.cli import main

main()
