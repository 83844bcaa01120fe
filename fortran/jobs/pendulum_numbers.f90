!> Numbers of a pendulum that vary from motion to motion.
module viscovib_pendulum_numbers
  use viscovib_kinds, only: wp
  use viscovib_pendulum, only: pendulum_parameters
  implicit none
  private

  public :: set_number

contains

  !> Another value of the number at a place among the words of `vary` in `scenes.toml`.
  pure subroutine set_number(p, place, value)
    type(pendulum_parameters), intent(inout) :: p
    integer, intent(in) :: place
    real(wp), intent(in) :: value

    select case (place)
    case (1)
      p%e = value
    case (2)
      p%w2 = value
    case (3)
      p%w3 = value
    case (4)
      p%alpha = value
    case (5:7)
      p%damping(place - 4) = value
    case (8:10)
      p%load(place - 7) = value
    case default
      p%frequency(place - 10) = value
    end select
  end subroutine set_number

end module viscovib_pendulum_numbers
