"""The verb ``reconstruct``: here, or on another machine."""
