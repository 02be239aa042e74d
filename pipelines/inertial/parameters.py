"""The parameters of the stages of limbs and simulated sensors."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict, Field, field_validator

from kinedex.catalog.limbs import chosen_limbs
from kinedex.ops.errors import KinedexError


class LimbOrientationsParameters(BaseModel):
    """The parameters of the stage `limb_orientations`."""

    model_config = ConfigDict(extra="forbid")

    where: str = Field("true", description="SQL filter over the columns of takes: those whose limbs are read")
    limbs: list[str] = Field(
        default_factory=list,
        description="limbs, or groups of them (trunk, head, arms, hands, legs), that are read; all unless given",
    )

    @field_validator("limbs")
    @classmethod
    def _known(cls, limbs: list[str]) -> list[str]:
        try:
            chosen_limbs(limbs)
        except KinedexError as fault:
            raise ValueError(str(fault)) from None
        return limbs

    @property
    def chosen(self) -> tuple[str, ...]:
        """The names of the limbs."""
        return chosen_limbs(self.limbs)
