!> Full equations of an oscillator on hereditary springs, attached to a polynomial form. The
!! unknowns are the coordinates u, followed by the hereditary variables v:
!!
!!   M u'' + C u' + F(u, v) - load,      -w_j(u) (on which 1 - R_j* acts).
module viscovib_full_oscillator
  use viscovib_kinds, only: wp
  use viscovib_oscillator, only: oscillator_type
  use viscovib_polynomial_form, only: full_system_type, polynomial_form_type
  implicit none
  private

  public :: put_behind

  type, extends(full_system_type) :: full_oscillator_type
    class(oscillator_type), allocatable :: oscillator
    !> Amplitudes of the loads, shape (n_dof, n_loads).
    real(wp), allocatable :: load(:, :)
  contains
    procedure :: sides
  end type full_oscillator_type

contains

  !> Attach the oscillator, with the loads of the form.
  subroutine put_behind(form, oscillator)
    type(polynomial_form_type), intent(inout) :: form
    class(oscillator_type), intent(in) :: oscillator
    type(full_oscillator_type), allocatable :: full
    allocate (full)
    allocate (full%oscillator, source=oscillator)
    full%load = form%load(:oscillator%n_dof(), :)
    call move_alloc(full, form%full)
  end subroutine put_behind

  subroutine sides(self, y, load, e)
    class(full_oscillator_type), intent(in) :: self
    real(wp), intent(in), contiguous :: y(:, :, 0:), load(:, :)
    real(wp), intent(out), contiguous :: e(:, :)
    real(wp), allocatable :: u(:, :), v(:, :), w(:, :), f(:, :)
    integer :: n, m, j

    associate (system => self%oscillator)
      n = system%n_dof()
      m = system%n_memory()
      u = y(:, :n, 0)
      v = y(:, n + 1:n + m, 0)
      allocate (w(size(y, 1), m), f(size(y, 1), n), source=0.0_wp)
      if (any(system%bent)) call system%deflection_remainder(u, w)
      do j = 1, m
        if (.not. system%bent(j)) w(:, j) = 0.0_wp
      end do
      w = w + matmul(u, transpose(system%gather))
      if (.not. system%separable) call system%force_remainder(u, v, f)
      e(:, :n) = matmul(y(:, :n, 2), transpose(system%mass)) &
                 + matmul(y(:, :n, 1), transpose(system%damping)) &
                 + matmul(v, transpose(system%spread)) + f - matmul(load, transpose(self%load))
      do j = 1, m
        e(:, n + j) = -w(:, j)
        ! Without a kernel the hereditary variable equals the spring variable.
        if (system%kernel_of(j) == 0) e(:, n + j) = v(:, j) - w(:, j)
      end do
    end associate
  end subroutine sides

end module viscovib_full_oscillator
