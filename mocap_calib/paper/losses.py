"""The paper's losses: similarity, differentiable matching, and geometric consistency.

SteerPose (Lee et al., BMVC 2025), section 3.2. `depths` does in torch what
`geometry.epipolar.depths` does in numpy: the solver works on tensors.
"""

import torch
from torch import Tensor

from mocap_calib.training.model import skew

_EPSILON = 1e-12


def similarity(displacement: Tensor, *, alpha: float) -> Tensor:
    """Return s = 2 / (1 + exp(alpha L_kp)) of section 3.2: 1 for the same pose, 0 for the farthest.

    displacement: `[...]` L_kp (eq. 1), any shape.
    """
    return 2 * torch.sigmoid(-alpha * displacement)


def keypoint_distance(steered: Tensor, pose: Tensor, seen: Tensor) -> Tensor:
    """Return L_kp (eq. 1) of all pairs of poses: `[..., I, J]` mean distance of the seen joints.

    steered: `[..., I, N, 2]` complete poses; pose: `[..., J, N, 2]` observed ones; seen:
    `[..., J, N]` bool. The size and place of a body in an image are not comparable between views:
    both poses are centred and scaled over the joints that pose j shows.
    """
    weight = seen.to(pose.dtype)
    weight = weight / weight.sum(-1, keepdim=True).clamp_min(1.0)  # (..., J, N)
    known = torch.where(seen[..., None], pose, torch.zeros_like(pose))
    observed = _centre_and_scale(known, weight)  # (..., J, N, 2)
    weight = weight[..., None, :, :]  # (..., 1, J, N)
    rotated = _centre_and_scale(steered[..., :, None, :, :], weight)  # (..., I, J, N, 2)
    offset = rotated - observed[..., None, :, :, :]
    distance = torch.sqrt(offset.square().sum(-1) + _EPSILON)  # (..., I, J, N)
    return (distance * weight).sum(-1)


def _centre_and_scale(pose: Tensor, weight: Tensor) -> Tensor:
    """Return poses `[..., N, 2]` centred, with an RMS radius of 1, under weights `[..., N]`."""
    weight = weight[..., None]
    offset = pose - (pose * weight).sum(-2, keepdim=True)
    square = (offset.square() * weight).sum((-1, -2), keepdim=True)
    return offset / torch.sqrt(square + _EPSILON)


def sinkhorn(score: Tensor, *, sharpness: float, sweeps: int) -> Tensor:
    """Return the doubly stochastic weights `[..., S, S]` of a square of similarities.

    Cuturi 2013, differentiable; in logarithms, so that any sharpness is safe; the columns are
    normalised last. Where one side has fewer instances, `with_dummies` has filled it up: rows and
    columns each sum to 1, dummies included.
    """
    weight = sharpness * score
    for _ in range(sweeps):
        weight = weight - weight.logsumexp(-1, keepdim=True)
        weight = weight - weight.logsumexp(-2, keepdim=True)
    return weight.exp()


def possible_matches(present_a: Tensor, present_b: Tensor) -> Tensor:
    """Return the pairs `[..., I, J]` of instances (`[..., I]`, `[..., J]` bool) that are there."""
    return present_a[..., :, None] & present_b[..., None, :]


def with_dummies(score: Tensor, present_a: Tensor, present_b: Tensor) -> Tensor:
    """Fill similarities `[..., I, J]` up to a square `[..., S, S]` with zeros: dummy targets.

    For numbers of instances that differ (N != N' in section 3.2). present_a: `[..., I]` and
    present_b: `[..., J]` bool; an instance that is not there is a dummy as well.
    """
    possible = possible_matches(present_a, present_b)
    rows, columns = score.shape[-2:]
    size = max(rows, columns)
    known = torch.where(possible, score, torch.zeros_like(score))
    return torch.nn.functional.pad(known, (0, size - columns, 0, size - rows))


def matching_loss(weight: Tensor, score: Tensor, present_a: Tensor, present_b: Tensor) -> Tensor:
    """Return L_match = sum w (1 - s) `[...]` over pairs of instances that are there.

    Section 3.2, one direction. weight: `[..., S, S]` of `sinkhorn`; score: `[..., I, J]`;
    present_a: `[..., I]` and present_b: `[..., J]` bool.
    """
    rows, columns = score.shape[-2:]
    possible = possible_matches(present_a, present_b)
    weight = weight[..., :rows, :columns]
    return (weight * (1 - score) * possible).sum((-1, -2))


def translation_matrix(rotation: Tensor, rays_a: Tensor, rays_b: Tensor, weight: Tensor) -> Tensor:
    """Return M(R) = sum w n n' `[..., 3, 3]`, n = (R u_a) x u_b.

    `collinearity_system` with the points eliminated (Kneip and Lynen 2013): what is left for t is
    sum (1 + 1 / (2 |n|^2)) n n'. Here the weight is 1, as n of rays that are nearly parallel, where
    |n| is small, is noise; a factor changes no zero, which is where the loss is led to.

    rotation: `[..., 3, 3]` b_from_a; rays: `[..., N, 3]` of unit length; weight: `[..., N]`, 0 = no
    match.
    """
    normal = torch.linalg.cross(rays_a @ rotation.transpose(-1, -2), rays_b)
    return torch.einsum("...n,...ni,...nj->...ij", weight, normal, normal)


def geometric_loss(rotation: Tensor, rays_a: Tensor, rays_b: Tensor, weight: Tensor) -> Tensor:
    """Return L_geom `[...]` (section 3.2) with the points eliminated, from the eigenvalues of M(R).

    sigma_1 / sigma_2 of the rows n: 0 where the rotation and the matches allow a translation.
    Shapes as in `translation_matrix`.
    """
    matrix = translation_matrix(rotation, rays_a, rays_b, weight)
    trace = matrix.diagonal(dim1=-2, dim2=-1).sum(-1)[..., None, None]
    values = torch.linalg.eigvalsh(matrix / (trace + _EPSILON))  # (..., 3) ascending
    # The root has no slope at zero: an angle of 1e-5 is below what any image resolves.
    smallest, second = values[..., 0].clamp_min(0), values[..., 1]
    return torch.sqrt((smallest + 1e-10) / (second + 1e-10))


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
            losses[k] = torch.sqrt((values[0] + _EPSILON) / (values[1] + _EPSILON))
    return torch.stack(losses).to(weight.dtype)


def translation_direction(
    rotation: Tensor, rays_a: Tensor, rays_b: Tensor, weight: Tensor
) -> tuple[Tensor, Tensor]:
    """Return the unit translation `[..., 3]` of a rotation, and how many matches agree `[...]`.

    The sign of the translation is chosen by cheirality; the second result is the share of the
    matches in front of both cameras. Shapes as in `translation_matrix`.
    """
    matrix = translation_matrix(rotation, rays_a, rays_b, weight)
    direction = torch.linalg.eigh(matrix)[1][..., 0]
    depth_a, depth_b = depths(rotation, direction, rays_a, rays_b)
    total = weight.sum(-1).clamp_min(_EPSILON)
    before_both = (depth_a > 0) & (depth_b > 0)
    behind_both = (depth_a < 0) & (depth_b < 0)
    in_front = (before_both * weight).sum(-1) / total
    behind = (behind_both * weight).sum(-1) / total
    reverse = (behind > in_front)[..., None]
    return torch.where(reverse, -direction, direction), torch.maximum(in_front, behind)


def depths(
    rotation: Tensor, translation: Tensor, rays_a: Tensor, rays_b: Tensor
) -> tuple[Tensor, Tensor]:
    """Return the distances `[..., N]` along both rays to the midpoint of their common normal.

    rotation: `[..., 3, 3]` and translation: `[..., 3]` of b_from_a; rays: `[..., N, 3]` of unit
    length. The numpy form is `geometry.epipolar.depths`.
    """
    turned = rays_a @ rotation.transpose(-1, -2)  # (..., N, 3)
    cosine = (turned * rays_b).sum(-1)
    along_a = (turned * translation[..., None, :]).sum(-1)
    along_b = (rays_b * translation[..., None, :]).sum(-1)
    sine2 = (1 - cosine.square()).clamp_min(1e-12)
    return (cosine * along_b - along_a) / sine2, (along_b - cosine * along_a) / sine2
