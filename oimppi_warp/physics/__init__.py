"""A scene as physics: Newton's model, and MuJoCo's made from it."""
