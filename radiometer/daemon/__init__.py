"""The daemon: readings over sockets, for weeks."""
