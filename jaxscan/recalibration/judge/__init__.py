"""What an adjustment gained, and whether the rig has drifted."""
