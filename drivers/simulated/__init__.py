"""A rig without hardware: each instrument is a process of its own behind the real protocol, and all share one world."""
