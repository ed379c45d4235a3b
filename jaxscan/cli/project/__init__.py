"""The verbs of projects: many captures by one file and one command."""
