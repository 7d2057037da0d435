"""Second, independent maker of capture sets: pixel by pixel, with effects hidden in them.

It shares no equation with `simulators` or `radiometer.reconciliation`: both are judged by what comes out of here.
Only the file types of `radiometer.data` are used, so that what it makes is what any program would hand over.
"""
