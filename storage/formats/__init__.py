"""File formats that kinedex reads and writes, by what they hold."""
