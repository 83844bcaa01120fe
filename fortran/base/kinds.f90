!> The one real kind of the library.
module viscovib_kinds
  use, intrinsic :: iso_fortran_env, only: int64, real64
  implicit none
  private

  !> Working precision of every real and complex number.
  integer, parameter, public :: wp = real64
  !> 64-bit integers, for counts that may exceed two thousand million.
  integer, parameter, public :: i8 = int64

end module viscovib_kinds
