! Optimize: -O3
!> The mean system of a motion of a condensed structure: its local stiffness without waves.
module viscovib_condensed_mean
  use viscovib_band_elimination, only: band_determinant
  use viscovib_condensed_hill, only: condensed_hill
  use viscovib_condensed_rows, only: retained_of
  use viscovib_dense, only: invert
  use viscovib_kinds, only: wp
  use viscovib_structure, only: structure_type
  implicit none
  private

  public :: average, moved_by_waves

  !> Fourier coefficients of J that are small compared with the largest hardly move exponents.
  real(wp), parameter :: faint = 1.0e-3_wp

contains

  !> I + H J_0 at s, J_0 the mean along the motion.
  function mean_system(self, system, s, h) result(matrix)
    type(condensed_hill), intent(in) :: self
    class(structure_type), intent(in) :: system
    complex(wp), intent(in) :: s, h(:, :)
    complex(wp) :: matrix(self%n_dof, self%n_dof), kept(1, size(self%kernel_of_group))
    integer :: a

    kept = retained_of(system, self%kernel_of_group, [s])
    matrix = matmul(h, self%local_at(0, 0, kept(1, :), s))
    do a = 1, self%n_dof
      matrix(a, a) = matrix(a, a) + 1.0_wp
    end do
  end function mean_system

  !> det(I + H J_0) at s: exponents of the mean system are zeros.
  subroutine average(self, system, s, value)
    type(condensed_hill), intent(in) :: self
    class(structure_type), intent(in) :: system
    complex(wp), intent(in) :: s
    complex(wp), intent(out) :: value
    complex(wp), dimension(self%n_dof, self%n_dof) :: matrix, h
    real(wp), dimension(self%n_dof, self%n_dof) :: re, im

    call system%rest%evaluate(s, h)
    matrix = mean_system(self, system, s, h)
    if (self%n_dof == 1) then
      value = matrix(1, 1)
      return
    end if
    re = real(matrix)
    im = aimag(matrix)
    call band_determinant(self%n_dof, self%n_dof, self%n_dof - 1, re, im, value)
  end subroutine average

  !> By how much, about, J - J_0 moves an exponent s of the mean system: through its neighbours at
  !! s + i m d, R sum_m |J_m|^2 |H_J(s + i m d)| with R/(s' - s) the part of
  !! H_J = (I + H J_0)^-1 H near s.
  subroutine moved_by_waves(self, system, s, distance, moved)
    type(condensed_hill), intent(in) :: self
    class(structure_type), intent(in) :: system
    complex(wp), intent(in) :: s
    !> Not distinguishable from s.
    real(wp), intent(in) :: distance
    real(wp), intent(out) :: moved
    complex(wp) :: places(2*self%reach + 1)
    complex(wp) :: h(2*self%reach + 1, self%n_dof, self%n_dof)
    real(wp) :: next, both, size_of
    integer :: waves(self%reach), i, m, n

    n = 0
    do m = 1, self%reach
      if (self%parts(m) <= faint) cycle
      n = n + 1
      waves(n) = m
      places(2*n) = s + cmplx(0.0_wp, m*self%period, wp)
      places(2*n + 1) = 2.0_wp*s - places(2*n)
    end do
    places(1) = s + distance
    call self%compliances(system, places(:2*n + 1), h(:2*n + 1, :, :))
    moved = 0.0_wp
    do i = 1, n
      m = waves(i)
      both = 0.0_wp
      call add(2*i)
      call add(2*i + 1)
      ! Strong waves come back more than once.
      size_of = self%sizes(m)
      if (allocated(self%by_rate)) then
        size_of = size_of + (abs(s) + m*self%period) &
                  *maxval(sum(abs(sum(self%by_rate(:, :, m, :), 3)), 2))
      end if
      next = size_of*both
      moved = moved + size_of*next*(1.0_wp + next)
    end do
    both = 0.0_wp
    call add(1)
    moved = moved*both*distance

  contains

    subroutine add(i)
      integer, intent(in) :: i
      complex(wp), dimension(self%n_dof, self%n_dof) :: matrix, inverse
      logical :: singular
      matrix = mean_system(self, system, places(i), h(i, :, :))
      if (self%n_dof == 1) then
        both = both + abs(h(i, 1, 1)/matrix(1, 1))
        return
      end if
      call invert(matrix, inverse, singular)
      if (singular) both = huge(1.0_wp)**0.25_wp
      if (.not. singular) both = both + maxval(sum(abs(matmul(inverse, h(i, :, :))), 2))
    end subroutine add

  end subroutine moved_by_waves

end module viscovib_condensed_mean
