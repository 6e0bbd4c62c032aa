"""What several plugin packages share and no interface needs: metrics, weight files, caches, rendering contexts.

A plugin may import it; the interfaces and the rest of `icub_core` do not.
"""
