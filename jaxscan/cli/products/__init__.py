"""The verbs for boards and configurations, and for the products of a scan: one file each."""
