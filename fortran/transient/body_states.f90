!> States of a body with a moving base, from the relative states in the equations.
module viscovib_body_states
  use viscovib_driven_system, only: driven_system_type
  use viscovib_kinds, only: wp
  use viscovib_law_branches, only: watched_function
  implicit none
  private

  public :: body_function, put_on_base

  !> A function of the state of the body, evaluated at states relative to its base.
  type, extends(watched_function) :: body_function
    class(driven_system_type), pointer :: system => null()
    class(watched_function), pointer :: signal => null()
  contains
    procedure :: at
  end type body_function

contains

  subroutine at(self, t, q, v, g)
    class(body_function), intent(in) :: self
    real(wp), intent(in) :: t(:), q(:, :), v(:, :)
    real(wp), intent(out) :: g(:)
    real(wp), dimension(size(q, 1), size(q, 2)) :: body_q, body_v
    body_q = q
    body_v = v
    call put_on_base(self%system, t, body_q, body_v)
    call self%signal%at(t, body_q, body_v, g)
  end subroutine at

  !> Convert relative states to states of the body at times, shape (size(t), n_dof).
  subroutine put_on_base(system, t, q, v)
    class(driven_system_type), intent(in) :: system
    real(wp), intent(in) :: t(:)
    real(wp), intent(inout) :: q(:, :), v(:, :)
    real(wp), dimension(size(q, 2)) :: here, rate
    integer :: i
    if (.not. system%base_motion%moves()) return
    do i = 1, size(t)
      here = q(i, :)
      rate = v(i, :)
      call system%add_base(t(i), here, rate)
      q(i, :) = here
      v(i, :) = rate
    end do
  end subroutine put_on_base

end module viscovib_body_states
