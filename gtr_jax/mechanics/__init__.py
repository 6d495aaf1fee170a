"""The mechanics of rod, tendon and friction at the nodes; knows no robot and no file."""
