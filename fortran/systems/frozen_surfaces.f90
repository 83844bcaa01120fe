!> Switching surfaces that cannot be crossed while the solution slides, or that an impact crosses.
module viscovib_frozen_surfaces
  use viscovib_kinds, only: wp
  use viscovib_law_branches, only: slides
  use viscovib_switched_laws, only: switched_laws
  implicit none
  private

  public :: frozen, jump_over, turn_over

contains

  !> True if surface k cannot be reached or left while the solution slides on its current surfaces.
  !! Examples: sticking friction in front of a stop, a closed stop where friction would reverse.
  !! Without this check rounding errors would cross the surface.
  logical function frozen(self, k, q) result(is_so)
    type(switched_laws), intent(in) :: self
    integer, intent(in) :: k
    real(wp), intent(in) :: q(:)
    real(wp) :: n(self%n_dof), own(self%n_dof), basis(self%n_dof, self%n_slides()), size_of
    integer :: i, j, m
    logical :: still

    is_so = .false.
    m = 0
    do j = 1, size(self%holds)
      if (self%holds(j) /= slides .or. self%leader(j) /= j) cycle
      call across(self, j, q, n, still)
      if (.not. still) cycle
      do i = 1, m
        n = n - dot_product(basis(:, i), n)*basis(:, i)
      end do
      size_of = norm2(n)
      if (.not. size_of > 1.0e-10_wp) cycle
      m = m + 1
      basis(:, m) = n/size_of
    end do
    if (m == 0) return
    call across(self, k, q, own, still)
    if (.not. still) return
    do i = 1, m
      own = own - dot_product(basis(:, i), own)*basis(:, i)
    end do
    is_so = norm2(own) <= 1.0e-10_wp
  end function frozen

  !> Unit vector normal to a surface; `still` is false if there is none.
  subroutine across(self, k, q, n, still)
    type(switched_laws), intent(in) :: self
    integer, intent(in) :: k
    real(wp), intent(in) :: q(:)
    real(wp), intent(out) :: n(:)
    logical, intent(out) :: still
    real(wp) :: b(size(n)), at(1, size(n)), g(1)

    if (self%element_of(k) > 0) then
      ! A constrained deflection reverses no hysteresis; its computed rate is rounding error.
      still = .true.
      n = self%elements(self%element_of(k))%e
      if (self%elements(self%element_of(k))%is_stop) call self%normal(k, n, b)
    else
      at(1, :) = q
      call self%signals(k)%at([0.0_wp], at, 0.0_wp*at, g)
      still = abs(g(1)) <= 0.0_wp
      associate (signal => self%signals(k))
        block
          real(wp) :: value(1), slopes(1, size(signal%by_q, 1))
          call signal%program%differentiate(matmul(at, transpose(signal%by_q)), value, slopes)
          n = matmul(slopes(1, :), signal%by_v)
          if (.not. norm2(n) > 0.0_wp) then
            n = matmul(slopes(1, :), signal%by_q)
            still = .true.
          end if
        end block
      end associate
    end if
    if (.not. norm2(n) > 0.0_wp) still = .false.
    if (still) n = n/norm2(n)
  end subroutine across

  !> Set the sides of surfaces across which an impact jumps without a contact phase.
  subroutine jump_over(laws, t, q, before, after, sides)
    class(switched_laws), intent(in) :: laws
    real(wp), intent(in) :: t, q(:), before(:), after(:)
    integer, intent(inout) :: sides(:)
    !> Fraction of a jump below which the solution is on the surface.
    real(wp), parameter :: nearly = 1.0e-10_wp
    real(wp) :: here(1, size(q)), g(1), was(1)
    integer :: k

    here(1, :) = q
    do k = 1, size(sides)
      if (laws%law_of(k) == 0) cycle
      call laws%signals(k)%at([t], here, reshape(before, [1, size(q)]), was)
      call laws%signals(k)%at([t], here, reshape(after, [1, size(q)]), g)
      if (abs(g(1)) > nearly*abs(g(1) - was(1)) .and. abs(g(1) - was(1)) > 0.0_wp) then
        sides(k) = merge(1, -1, g(1) > 0.0_wp)
      end if
    end do
  end subroutine jump_over

  !> Reverse the direction of hysteresis elements whose rate changes sign in an impact.
  subroutine turn_over(laws, q, v, sides)
    type(switched_laws), intent(inout) :: laws
    real(wp), intent(in) :: q(:), v(:)
    integer, intent(inout) :: sides(:)
    real(wp) :: d(1), rate(1)
    integer :: k

    do k = 1, size(sides)
      if (laws%element_of(k) == 0 .or. laws%which(k) /= 1) cycle
      associate (element => laws%elements(laws%element_of(k)))
        if (element%is_stop) cycle
        d = laws%deflection(laws%element_of(k), reshape(q, [1, size(q)]))
        rate = laws%deflection(laws%element_of(k), reshape(v, [1, size(v)]))
        if (.not. sides(k)*rate(1) < 0.0_wp) cycle
        call element%turn(1, d(1))
        sides(k) = -sides(k)
      end associate
    end do
  end subroutine turn_over

end module viscovib_frozen_surfaces
