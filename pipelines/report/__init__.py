"""Reports: what a pipeline's results say, on one HTML page that needs nothing else."""
