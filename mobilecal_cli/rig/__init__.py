"""The rig: rig.yaml, and what a recording and a URDF tell, by message type and name, where it gives nothing."""
