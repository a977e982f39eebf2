"""The page in the field: what a survey is at while it runs, for a phone or a tablet.

Public:

- ``feed.Feed``: what the page shows: volume and sigma so far, the map of what another pass would
  gain, the state of the sensors. ``volume_node`` and others feed it; any thread may.
- ``field_page``: the page and its stream of states over HTTP (server-sent events), on loopback or,
  with a token, on another address.
- ``foxglove_live``: the topics of the nodes for Foxglove over a WebSocket.
- ``place.place_of``: addresses as the command line takes them.

Nothing is fetched from the internet, and nothing that a client sends changes anything. The nodes
that bring data here are in ``nodes.viewers``: this room knows no ROS. docs/quick_start.md says how
to open the page, docs/security.md who can reach it.
"""
