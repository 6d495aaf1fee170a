"""The base model of several tendons: friction follows the slip. All nodes are solved at once, by dense Newton
steps around a march whose friction is known.
"""
