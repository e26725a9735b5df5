"""The rig in front of you: its newest moment labelled, and what is wrong with it said at once."""
