//! Batches in which some slots are empty.

use tch::{Kind, Tensor};

/// Which of the `rows × places` slots of a batch are occupied. Layers that treat each slot by
/// itself work on the occupied slots, `[P, ..]`. Only operations across the slots of a row need the
/// whole batch, `[rows, places, ..]`, with zeros in empty slots.
#[derive(Debug)]
pub struct Packing {
    rows: i64,
    places: i64,
    /// Indices of the occupied slots, ascending, `[P]`; `None` if all slots are occupied.
    filled: Option<Tensor>,
}

impl Packing {
    /// Creates a packing in which every slot is occupied.
    pub fn full(rows: i64, places: i64) -> Self {
        Packing { rows, places, filled: None }
    }

    /// Creates a packing in which the slots where `present: [rows, places]` is not 0 are occupied.
    pub fn of(present: &Tensor) -> Self {
        let (rows, places) = present.size2().expect("presence is [rows, places]");
        Packing { rows, places, filled: Some(present.reshape([-1]).nonzero().squeeze_dim(-1)) }
    }

    /// Returns the occupied slots of `x: [rows, places, ..]` as `[P, ..]`.
    pub fn pack(&self, x: &Tensor) -> Tensor {
        let flat = x.flatten(0, 1);
        self.filled
            .as_ref()
            .map_or_else(|| flat.shallow_clone(), |filled| flat.index_select(0, filled))
    }

    /// Puts `x: [P, K]` back into its slots and returns `[rows, places, K]`, with zeros in empty
    /// slots.
    pub fn unpack(&self, x: &Tensor) -> Tensor {
        let width = x.size()[1];
        let flat = match &self.filled {
            None => x.shallow_clone(),
            Some(filled) => {
                let empty = Tensor::zeros([self.rows * self.places, width], (x.kind(), x.device()));
                empty.index_copy(0, filled, x)
            }
        };
        flat.view([self.rows, self.places, width])
    }

    /// Selects the slots `samples: [S]` from tensors of the occupied slots, `[P, ..]`. The samples
    /// are ascending indices among all slots, and the slots must be occupied.
    pub fn take<const K: usize>(&self, tensors: [&Tensor; K], samples: &Tensor) -> [Tensor; K] {
        let count = self.filled.as_ref().map_or(self.rows * self.places, |filled| filled.size()[0]);
        if samples.size()[0] == count {
            return tensors.map(Tensor::shallow_clone);
        }
        let positions = self.filled.as_ref().map(|filled| {
            let numbers = Tensor::arange(count, (Kind::Int64, filled.device()));
            let empty = Tensor::zeros([self.rows * self.places], (Kind::Int64, filled.device()));
            empty.index_copy(0, filled, &numbers).index_select(0, samples)
        });
        tensors.map(|x| x.index_select(0, positions.as_ref().unwrap_or(samples)))
    }

    /// Returns the indices of agents among all `rows × places` slots from their positions among the
    /// P occupied ones, `[K]`.
    pub(super) fn slots(&self, positions: &Tensor) -> Tensor {
        let filled = self.filled.as_ref();
        filled.map_or_else(|| positions.shallow_clone(), |filled| filled.index_select(0, positions))
    }

    /// Returns the positions among the P occupied slots of the agents in slot `place: [K]` of the
    /// row of another agent, whose position is `other: [K]`. Those slots must be occupied.
    pub(super) fn positions_in_row(&self, other: &Tensor, place: &Tensor) -> Tensor {
        let row = self.slots(other).floor_divide_scalar(self.places);
        let slot = row * self.places + place;
        self.filled.as_ref().map_or_else(
            || slot.shallow_clone(),
            |filled| {
                let all = self.rows * self.places;
                let numbers = Tensor::arange(filled.size()[0], (Kind::Int64, filled.device()));
                let empty = Tensor::zeros([all], (Kind::Int64, filled.device()));
                empty.index_copy(0, filled, &numbers).index_select(0, &slot)
            },
        )
    }

    /// Returns the number of rows and the number of slots per row.
    pub fn size(&self) -> (i64, i64) {
        (self.rows, self.places)
    }
}

#[cfg(test)]
mod tests {
    use tch::Device;

    use super::*;

    #[test]
    fn packed_places_come_back_and_the_others_are_zero() {
        let present = Tensor::from_slice(&[1_f32, 0.0, 1.0, 0.0, 0.0, 1.0]).view([2, 3]);
        let x = Tensor::arange(12, (Kind::Float, Device::Cpu)).view([2, 3, 2]) + 1.0;
        let packing = Packing::of(&present);
        let packed = packing.pack(&x);
        assert_eq!(
            Vec::<f32>::try_from(packed.flatten(0, 1)).unwrap(),
            [1.0, 2.0, 5.0, 6.0, 11.0, 12.0]
        );
        assert!(packing.unpack(&packed).equal(&(&x * present.unsqueeze(-1))));
        let standing = |in_these: &[i64]| {
            let [of_first] = packing.take([&packed.select(1, 0)], &Tensor::from_slice(in_these));
            Vec::<f32>::try_from(of_first).unwrap()
        };
        assert_eq!(standing(&[0, 5]), [1.0, 11.0]);
        assert_eq!(standing(&[2]), [5.0]);
        assert_eq!(standing(&[0, 2, 5]), [1.0, 5.0, 11.0]);
        let full = Packing::full(2, 3);
        let [second] = full.take([&full.pack(&x)], &Tensor::from_slice(&[1_i64]));
        assert!(second.equal(&x.get(0).narrow(0, 1, 1)));
        assert!(full.unpack(&full.pack(&x)).equal(&x));
    }
}
