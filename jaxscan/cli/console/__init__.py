"""`jaxscan console`: the scan from a web page.

Only the main thread drives the rig (`desk.py`, with the sessions of `jaxscan scan` in `sessions.py`). The server's
thread (`pages.py`) shows what the slate (`slate.py`) holds, and passes orders on. Other threads draw pictures, notice
that the rig is silent (`watching.py`), and call other verbs (`works.py`).
"""
