"""L_geom of the paper's whole system of collinearity, whose points our solver eliminates."""

import torch
from torch import Tensor

from mocap_calib.training.model import skew

EPSILON = 1e-12


def collinearity_system(rotation: Tensor, rays_a: Tensor, rays_b: Tensor) -> Tensor:
    """Return A `[7 N, 3 N + 3]` of the paper's A [x_1 .. x_N t]' = 0 (section 3.2).

    With the points x in the axes of a: u_a x x = 0 and u_b x (R x + t) = 0 (collinearity), and
    t . (R u_a x u_b) = 0 (coplanarity). rotation: `[3, 3]` b_from_a; rays u: `[N, 3]` of unit
    length.
    """
    count = len(rays_a)
    cross_a, cross_b = skew(rays_a), skew(rays_b)  # (N, 3, 3)
    normal = torch.linalg.cross(rays_a @ rotation.T, rays_b)  # (N, 3)
    nothing = rays_a.new_zeros(3 * count, 3)
    seen_by_a = torch.cat([_block_diagonal(cross_a), nothing], -1)
    seen_by_b = torch.cat([_block_diagonal(cross_b @ rotation), cross_b.reshape(-1, 3)], -1)
    coplanar = torch.cat([rays_a.new_zeros(count, 3 * count), normal], -1)
    return torch.cat([seen_by_a, seen_by_b, coplanar], -2)


def _block_diagonal(blocks: Tensor) -> Tensor:
    """Return the matrix `[3 N, 3 N]` with blocks `[N, 3, 3]` on its diagonal."""
    count = len(blocks)
    apart = torch.eye(count, dtype=blocks.dtype, device=blocks.device)
    return torch.einsum("kl,kij->kilj", apart, blocks).reshape(3 * count, 3 * count)


def full_geometric_loss(rotation: Tensor, rays_a: Tensor, rays_b: Tensor, weight: Tensor) -> Tensor:
    """Return L_geom `[B]` as the paper has it: sigma_1 / sigma_2 of the whole system.

    In double precision, from the eigenvalues of A'A, which has a row for each coordinate of each
    point. Shapes as in `geometric_loss`, with one axis in front; 0 without a match.
    """
    losses = [weight.new_zeros((), dtype=torch.float64) for _ in range(len(weight))]
    for k, of_one in enumerate(weight):
        known = of_one > 0
        if known.any():
            rays = (rays_a[k, known].double(), rays_b[k, known].double())
            system = collinearity_system(rotation[k].double(), *rays)
            values = torch.linalg.eigvalsh(system.T @ system).clamp_min(0)
            losses[k] = torch.sqrt((values[0] + EPSILON) / (values[1] + EPSILON))
    return torch.stack(losses).to(weight.dtype)
