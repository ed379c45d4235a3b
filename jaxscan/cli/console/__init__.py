"""`jaxscan console`: the scan from a web page.

The main thread drives the rig (`desk.py`, with the sessions of `jaxscan scan` in `sessions.py`) and is the only one
that does; the server's thread (`pages.py`) shows what the `slate.py` holds and passes orders on; others draw pictures
and notice that the rig is silent (`watching.py`), and call other verbs (`works.py`).
"""
