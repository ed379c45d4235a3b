"""What a solve is worth: tests of the models, lengths in millimetres, advice."""
