"""The engine reads pipeline files, plans which stages run, runs them on cores or a cluster, and lists past runs."""
