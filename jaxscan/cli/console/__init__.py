"""`jaxscan console`: the scan from a web page.

The main thread drives the rig (`desk.py`, with the sessions of `jaxscan scan`) and is the only one that does; the
server's thread (`serving`) shows what the `slate.py` holds and passes orders on; others draw pictures (`painter.py`)
and call other verbs (`works.py`).
"""
