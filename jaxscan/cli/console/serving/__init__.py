"""The console for browsers: its addresses, its socket, who operates, and the viewer for finished clouds."""
