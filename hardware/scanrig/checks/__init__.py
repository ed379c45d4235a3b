"""What is looked at in the pictures while the rig works."""
