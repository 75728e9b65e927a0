"""What both ends of a job agree on, and the wrapper of one worker on one machine.

Imports no sibling package: the App, the loader and deploy all stand on this one.
"""
