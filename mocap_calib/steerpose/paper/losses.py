"""The paper's losses (section 3.2): similarity, differentiable matching, and geometric consistency."""

import torch
from torch import Tensor

from mocap_calib.steerpose.steer import skew

_EPSILON = 1e-12


def similarity(displacement: Tensor, alpha: float = 3.0) -> Tensor:
    """The paper's s = 2 / (1 + exp(alpha L_kp)): 1 for the same pose, 0 for the farthest. Any shape."""
    return 2 * torch.sigmoid(-alpha * displacement)


def keypoint_distance(steered: Tensor, pose: Tensor, seen: Tensor) -> Tensor:
    """L_kp (eq. 1) of all pairs: `[..., I, J]` mean distance of the joints that are seen.

    steered: `[..., I, N, 2]` complete poses; pose: `[..., J, N, 2]` observed, seen: `[..., J, N]`. The size and place of a
    body in an image are not comparable between views: both are centred and scaled over the joints that pose j shows.
    """
    weight = seen.to(pose.dtype)
    weight = weight / weight.sum(-1, keepdim=True).clamp_min(1.0)  # (..., J, N)
    observed = _unit(torch.where(seen[..., None], pose, torch.zeros_like(pose)), weight)
    rotated = _unit(steered[..., :, None, :, :], weight[..., None, :, :])  # (..., I, J, N, 2)
    distance = torch.sqrt((rotated - observed[..., None, :, :, :]).square().sum(-1) + _EPSILON)
    return (distance * weight[..., None, :, :]).sum(-1)


def _unit(pose: Tensor, weight: Tensor) -> Tensor:
    """Centred, with an RMS radius of 1, over the joints that have weight."""
    weight = weight[..., None]
    offset = pose - (pose * weight).sum(-2, keepdim=True)
    return offset / torch.sqrt((offset.square() * weight).sum((-1, -2), keepdim=True) + _EPSILON)


def sinkhorn(score: Tensor, *, sharpness: float = 10.0, sweeps: int = 20) -> Tensor:
    """Doubly stochastic weights of a square of similarities (Cuturi 2013), differentiable. `[..., S, S]`.

    Where one side has fewer instances, `with_dummies` has filled it up: rows and columns each sum to 1, dummies included.
    In logarithms, so that any sharpness is safe; the columns are normalised last.
    """
    weight = sharpness * score
    for _ in range(sweeps):
        weight = weight - weight.logsumexp(-1, keepdim=True)
        weight = weight - weight.logsumexp(-2, keepdim=True)
    return weight.exp()


def with_dummies(score: Tensor, there_a: Tensor, there_b: Tensor) -> Tensor:
    """Dummy targets for N != N': similarities `[..., I, J]` filled up to a square `[..., S, S]` with zeros.

    there_a: `[..., I]` and there_b: `[..., J]` bool; an instance that is not there is a dummy as well.
    """
    real = there_a[..., :, None] & there_b[..., None, :]
    rows, columns = score.shape[-2:]
    size = max(rows, columns)
    return torch.nn.functional.pad(
        torch.where(real, score, torch.zeros_like(score)), (0, size - columns, 0, size - rows)
    )


def matching_loss(weight: Tensor, score: Tensor, there_a: Tensor, there_b: Tensor) -> Tensor:
    """L_match = sum w (1 - s) over pairs of instances that are there, one direction. `[..., S, S]`, `[..., I, J]` -> `[...]`."""
    rows, columns = score.shape[-2:]
    real = there_a[..., :, None] & there_b[..., None, :]
    return (weight[..., :rows, :columns] * (1 - score) * real).sum((-1, -2))


def geometric_system(rotation: Tensor, points_a: Tensor, points_b: Tensor) -> Tensor:
    """A of A [x_1 .. x_N t]' = 0 (section 3.2): collinearity and coplanarity, `[..., 7 N, 3 N + 3]`.

    rotation: `[..., 3, 3]` b_from_a; points: `[..., N, 3]` normalised image points or rays u of the matches. With X_k in the
    axes of a: u_a x X_k = 0 and u_b x (R X_k + t) = 0 (collinearity), and t . (R u_a x u_b) = 0 (coplanarity).
    """
    count = points_a.shape[-2]
    cross_a, cross_b = skew(points_a), skew(points_b)  # (..., N, 3, 3)
    turned = cross_b @ rotation[..., None, :, :]
    normal = torch.linalg.cross(points_a @ rotation.transpose(-1, -2), points_b)
    eye = torch.eye(count, dtype=points_a.dtype, device=points_a.device)
    batch = normal.shape[:-2]

    def blocks(block: Tensor) -> Tensor:
        """`[..., N, 3, 3]` onto the diagonal of `[..., 3 N, 3 N]`."""
        spread = torch.einsum("...kij,kl->...kilj", block, eye)
        return spread.reshape(*block.shape[:-3], 3 * count, 3 * count).expand(*batch, -1, -1)

    def column(block: Tensor) -> Tensor:
        return block.reshape(*block.shape[:-3], -1, 3).expand(*batch, -1, -1)

    zero = torch.zeros(*batch, 3 * count, 3, dtype=points_a.dtype, device=points_a.device)
    first = torch.cat([blocks(cross_a), zero], -1)
    second = torch.cat([blocks(turned), column(cross_b)], -1)
    empty = torch.zeros(*batch, count, 3 * count, dtype=points_a.dtype, device=points_a.device)
    third = torch.cat([empty, normal.expand(*batch, -1, -1)], -1)
    return torch.cat([first, second, third], -2)


def geometric_loss_full(rotation: Tensor, points_a: Tensor, points_b: Tensor) -> Tensor:
    """L_geom = sigma_1 / sigma_2 of the paper's full system, `[...]`: 0 where R and the matches allow a translation.

    An SVD of `[7 N, 3 N + 3]`: the reference that the reduced form is tested against.
    """
    values = torch.linalg.svdvals(geometric_system(rotation, points_a, points_b))
    return values[..., -1] / values[..., -2]


def translation_matrix(rotation: Tensor, rays_a: Tensor, rays_b: Tensor, weight: Tensor) -> Tensor:
    """M(R) = sum w n n', n = (R u_a) x u_b: the full system with the points eliminated (Kneip and Lynen 2013). `[..., 3, 3]`.

    rays: `[..., N, 3]` of unit length; weight: `[..., N]`, 0 = no match.
    """
    normal = torch.linalg.cross(rays_a @ rotation.transpose(-1, -2), rays_b)
    return torch.einsum("...n,...ni,...nj->...ij", weight, normal, normal)


def geometric_loss(rotation: Tensor, rays_a: Tensor, rays_b: Tensor, weight: Tensor) -> Tensor:
    """L_geom in its reduced form: sigma_1 / sigma_2 of the rows n, from the eigenvalues of M(R). `[...]`."""
    matrix = translation_matrix(rotation, rays_a, rays_b, weight)
    values = torch.linalg.eigvalsh(
        matrix / (matrix.diagonal(dim1=-2, dim2=-1).sum(-1)[..., None, None] + _EPSILON)
    )
    # the root has no slope at zero: an angle of 1e-5 is below what any image resolves
    return torch.sqrt((values[..., 0].clamp_min(0) + 1e-10) / (values[..., 1] + 1e-10))


def translation_direction(
    rotation: Tensor, rays_a: Tensor, rays_b: Tensor, weight: Tensor
) -> tuple[Tensor, Tensor]:
    """Unit t `[..., 3]` for a rotation, its sign by cheirality, and the share `[...]` of matches in front of both cameras."""
    t = torch.linalg.eigh(translation_matrix(rotation, rays_a, rays_b, weight))[1][..., 0]
    near_a, near_b = depths(rotation, t, rays_a, rays_b)
    total = weight.sum(-1).clamp_min(_EPSILON)
    ahead = (((near_a > 0) & (near_b > 0)) * weight).sum(-1) / total
    behind = (((near_a < 0) & (near_b < 0)) * weight).sum(-1) / total
    return torch.where((behind > ahead)[..., None], -t, t), torch.maximum(ahead, behind)


def depths(
    rotation: Tensor, translation: Tensor, rays_a: Tensor, rays_b: Tensor
) -> tuple[Tensor, Tensor]:
    """Distances along both unit rays to the midpoint of their common normal, `[..., N]` each (as geometry.epipolar.depths)."""
    turned = rays_a @ rotation.transpose(-1, -2)
    cosine = (turned * rays_b).sum(-1)
    along_a = (turned * translation[..., None, :]).sum(-1)
    along_b = (rays_b * translation[..., None, :]).sum(-1)
    sine2 = (1 - cosine.square()).clamp_min(1e-12)
    return (cosine * along_b - along_a) / sine2, (along_b - cosine * along_a) / sine2
