"""Loop closure: detection of revisited places, the pose graph, and the map rebuilt from its poses."""
