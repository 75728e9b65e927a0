"""A cloud in one Linux machine: an EC2 endpoint whose instances really boot.

Everything lives in namespaces that processes of the test hold through a pipe: whichever way the
test ends, the pipe ends, so do the processes, and the kernel takes the rest. Nothing is named in
the machine's own network, so two test beds do not meet.
"""
