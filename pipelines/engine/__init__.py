"""The engine reads pipeline files, plans which stages run, and runs them on the cores of a machine or on a cluster."""
