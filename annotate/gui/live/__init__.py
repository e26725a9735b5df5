"""The live window: a running rig as cloud and pictures."""
