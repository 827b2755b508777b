//! Batches in which some places are empty.

use tch::{Kind, Tensor};

/// Which of the `rows × places` of a batch are filled. Layers that treat every place alone work on the filled ones,
/// `[P, ..]`; only what looks across a row needs the whole, `[rows, places, ..]`, with zeros where nothing is.
#[derive(Debug)]
pub struct Packing {
    rows: i64,
    places: i64,
    /// Filled places in order, `[P]`; `None`: all of them.
    filled: Option<Tensor>,
}

impl Packing {
    /// Every place is filled.
    pub fn full(rows: i64, places: i64) -> Self {
        Packing { rows, places, filled: None }
    }

    /// Those places are filled where `present: [rows, places]` is not 0.
    pub fn of(present: &Tensor) -> Self {
        let (rows, places) = present.size2().expect("presence is [rows, places]");
        Packing { rows, places, filled: Some(present.reshape([-1]).nonzero().squeeze_dim(-1)) }
    }

    /// The filled places of `x: [rows, places, ..]`, as `[P, ..]`.
    pub fn pack(&self, x: &Tensor) -> Tensor {
        let flat = x.flatten(0, 1);
        self.filled.as_ref().map_or_else(|| flat.shallow_clone(), |filled| flat.index_select(0, filled))
    }

    /// `x: [P, K]` put back into its places, `[rows, places, K]`.
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

    /// Numbers among the packed places of `samples: [S]`, which are numbers among all places and filled.
    pub fn positions(&self, samples: &Tensor) -> Tensor {
        match &self.filled {
            None => samples.shallow_clone(),
            Some(filled) => {
                let device = samples.device();
                let numbers = Tensor::arange(filled.size()[0], (Kind::Int64, device));
                let empty = Tensor::zeros([self.rows * self.places], (Kind::Int64, device));
                empty.index_copy(0, filled, &numbers).index_select(0, samples)
            }
        }
    }

    /// Rows and places.
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
        assert_eq!(Vec::<f32>::try_from(packed.flatten(0, 1)).unwrap(), [1.0, 2.0, 5.0, 6.0, 11.0, 12.0]);
        assert!(packing.unpack(&packed).equal(&(&x * present.unsqueeze(-1))));
        let positions = packing.positions(&Tensor::from_slice(&[5_i64, 0]));
        assert_eq!(Vec::<i64>::try_from(positions).unwrap(), [2, 0]);
        let full = Packing::full(2, 3);
        assert!(full.unpack(&full.pack(&x)).equal(&x));
    }
}
