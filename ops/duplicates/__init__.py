"""The same motion twice: alignments of takes by equal runs of words, judged by the places of their joints."""
