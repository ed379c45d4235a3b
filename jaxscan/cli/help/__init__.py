"""Words about the verbs: pages of help, answers to mistyped names, and completion for shells."""
