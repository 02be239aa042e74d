"""`python -m kinedex` does what the console command `kinedex` does."""

from kinedex.pipelines.cli import main

main()
