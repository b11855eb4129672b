"""Physics models of a scene: Newton's, and MuJoCo's made from it."""
