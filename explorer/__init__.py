"""The explorer: a local server over one store, and the page that it serves (`kinedex explore STORE`).

One module serves one subject and lists its addresses as `routes`; `application` joins them. Nothing here computes what
a room below should compute.
"""
