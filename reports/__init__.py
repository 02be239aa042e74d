"""Reports: the results of a pipeline on one HTML page that needs nothing else, and figures of templates."""
