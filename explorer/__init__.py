"""The explorer: a local server over one store, and the page that it serves (`kinedex explore STORE`).

Each module serves one topic and lists its addresses as `routes`; `application` joins them. The modules only answer
requests; computations are in the packages that they import.
"""
