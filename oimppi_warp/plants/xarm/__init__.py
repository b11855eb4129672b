"""The xArm: a plant that moves it through the vendor's SDK, and an emulation of its controller to try that with."""
