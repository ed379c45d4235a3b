"""`jaxscan design`: words and numbers of a person to a rig, and back."""
