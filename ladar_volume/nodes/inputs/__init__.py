"""One stream of inputs for those who use them and for the log.

DDS lets two listeners hear different first messages of a driver that starts after them, or of one
that was there before. ``publisher_streams`` tells where the messages of a publisher begin;
``heard_inputs`` hands copies of the first ones that georeference_node uses to the log
(``input_copies`` is how they travel); ``logged_inputs`` takes those that the log lacks, and names
those that georeference_node did not hear, which a replay leaves out.
"""
