!> Systems whose vectors are polynomials in p: flat + p direction_1 + p^2 direction_2 + ...
module viscovib_vector_builder
  use viscovib_binding_tools, only: make_system
  use viscovib_family_curve, only: system_builder
  use viscovib_kinds, only: wp
  use viscovib_limits, only: nearly_nothing
  use viscovib_oscillator, only: oscillator_type
  use viscovib_status, only: status_type
  implicit none
  private

  public :: vector_builder, vector_at

  type, extends(system_builder) :: vector_builder
    !> As for `make_system`; the directions are concatenated.
    real(wp), allocatable :: flat(:), direction(:), data_x(:), data_phi(:)
    integer :: kind_x = 0, kind_phi = 0
  contains
    procedure :: build
  end type vector_builder

contains

  !> System vector at p.
  pure function vector_at(flat, direction, p) result(vector)
    real(wp), intent(in) :: flat(:), direction(:), p
    real(wp) :: vector(size(flat)), x
    integer :: k, n

    x = merge(p, nearly_nothing, abs(p) > 0.0_wp)
    n = size(flat)
    vector = 0.0_wp
    do k = size(direction)/n, 1, -1
      vector = (vector + direction((k - 1)*n + 1:k*n))*x
    end do
    vector = flat + vector
  end function vector_at

  subroutine build(self, p, system, status)
    class(vector_builder), intent(in) :: self
    real(wp), intent(in) :: p
    class(oscillator_type), allocatable, intent(out) :: system
    type(status_type), intent(out) :: status
    call make_system(system, vector_at(self%flat, self%direction, p), self%kind_x, self%data_x, &
                     self%kind_phi, self%data_phi, status)
  end subroutine build

end module viscovib_vector_builder
