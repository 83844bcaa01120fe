! Optimize: -O2 -fstack-arrays
!> All isolated solutions of a small polynomial system of degree 3, by path tracking from
!! a system with known solutions (Sommese and Wampler, The numerical solution of systems
!! of polynomials, 2005, chapters 2, 7 and 8): first from products of linear forms to a system of
!! the same terms with random coefficients, and from its finite solutions to any member.
!!
!! The number of solutions is the same for almost all coefficients. If Newton's method
!! converges from the solutions of the previous member to as many different ones, these are all.
!! Sign changes that preserve every term, and conjugation, map solutions to solutions.
!!
!! The random system of a set of terms is the same in every call, so the last ones are kept for the
!! whole program, protected by a lock.
module viscovib_homotopy
  use viscovib_dense, only: solve_complex
  use viscovib_kinds, only: wp
  use viscovib_locks, only: release_lock, take_lock
  use viscovib_solution_paths, only: correct, follow, infinite, max_unknowns, polynomials_type, &
    size_of
  use viscovib_stopping, only: is_set
  implicit none
  private

  public :: family_type, max_unknowns, new_family

  !> Bound of a path towards a member of the family; it may temporarily become large.
  real(wp), parameter :: far = 1.0e8_wp

  !> Systems with the same terms.
  type :: family_type
    type(polynomials_type) :: system
    !> Coefficients and solutions, shape (n, n_solutions), of a random member.
    complex(wp), allocatable :: generic(:), solutions(:, :)
    !> Index of the conjugate of each unknown.
    integer, allocatable, private :: mirror(:)
    !> Sign changes of the unknowns that preserve all terms, shape (n, n_signs), the first all 1.
    real(wp), allocatable, private :: signs(:, :)
    !> For each solution of the random member the solution and the sign change that give it.
    integer, allocatable, private :: leader(:), image(:)
    !> The previous member, its solutions, their largest number so far, the unit of their unknowns,
    !! and the solution and sign change that give each one, with conjugation above n_signs.
    complex(wp), allocatable, private :: last_coefficients(:), last(:, :)
    integer, private :: most = 0
    integer, allocatable, private :: last_leader(:), last_image(:)
    real(wp), private :: last_unit = 0.0_wp
  contains
    procedure :: solve_member
    procedure :: is_of
    procedure, private :: choose_generic
    procedure, private :: find_signs
    procedure, private :: find_images
    procedure, private :: imaged
    procedure, private :: solve_near
  end type family_type

  integer, parameter :: most_kept = 64
  !> Families as built by `new_family`; accessed only with the lock.
  type(family_type) :: kept(most_kept)
  integer :: n_kept = 0

contains

  !> Build the family. Unknowns and coefficients should be scaled to the size 1.
  subroutine new_family(family, n, conjugates, row, at, cancel)
    type(family_type), intent(out) :: family
    integer, intent(in) :: n
    !> True if the second half of the unknowns are conjugates of the first; else unknowns are real.
    logical, intent(in) :: conjugates
    integer, intent(in) :: row(:), at(:, :)
    !> A nonzero value, possibly set by another thread, interrupts.
    integer, intent(inout) :: cancel
    complex(wp) :: forms(0:n, 3, n), x(n)
    complex(wp), allocatable :: found(:, :)
    integer :: kinds(3, n), i, k
    logical :: careful, met

    family%system = polynomials_type(n, row, at)
    family%mirror = [(i, i=1, n)]
    if (conjugates) family%mirror = modulo(family%mirror - 1 + n/2, n) + 1
    call recall(family)
    if (allocated(family%solutions)) return
    call family%find_signs()
    call family%choose_generic()
    call find_forms(family%system, merge(n/2, n, conjugates), kinds, forms)
    allocate (found(n, 3**n))
    careful = .false.
    k = 0
    do
      met = .false.
      call choose(1, [integer ::])
      call complete()
      ! If two paths have the same end, or an image is no end of a path, a path was wrong.
      if (careful .or. .not. met) exit
      careful = .true.
    end do
    family%solutions = found(:, :k)
    call family%find_images(family%solutions, size(family%signs, 2), family%leader, family%image)
    ! Between members with the same symmetry solutions may coincide; this detour avoids it.
    family%generic = family%generic*wave(0.2360679774997897_wp)
    if (.not. is_set(cancel)) call keep(family)

  contains

    !> Start a path at the common zero of one form of each equation.
    recursive subroutine choose(equation, chosen)
      integer, intent(in) :: equation, chosen(:)
      complex(wp) :: matrix(n, n)
      integer :: q
      logical :: ended, singular
      if (is_set(cancel)) return
      if (equation <= n) then
        do q = 1, 3
          if (kinds(q, equation) > 0) call choose(equation + 1, [chosen, q])
        end do
        return
      end if
      do q = 1, n
        matrix(q, :) = forms(1:, chosen(q), q)
        x(q) = -forms(0, chosen(q), q)
      end do
      if (conjugates) then
        ! Skip choices with more forms of one half of the unknowns than it has unknowns.
        if (count([(kinds(chosen(q), q) == 1, q=1, n)]) > n/2) return
        if (count([(kinds(chosen(q), q) == 2, q=1, n)]) > n/2) return
      end if
      call solve_complex(matrix, x, .false., singular)
      if (singular) return
      call follow(family%system, family%generic, family%generic, infinite, careful, x, ended, forms)
      if (.not. ended) return
      if (careful .and. known(found(:, :k), x)) return
      if (known(found(:, :k), x)) then
        met = .true.
      else
        k = k + 1
        found(:, k) = x
      end if
    end subroutine choose

    !> Add the images of solutions, which are solutions as well.
    subroutine complete()
      complex(wp) :: y(n)
      integer :: way, which
      which = 1
      do while (which <= k)
        do way = 2, 2*size(family%signs, 2)
          y = family%imaged(found(:, which), way)
          if (place_of(found(:, :k), y, 1.0e-6_wp) > 0) cycle
          met = .true.
          if (k == size(found, 2)) return
          k = k + 1
          found(:, k) = y
        end do
        which = which + 1
      end do
    end subroutine complete

  end subroutine new_family

  !> Restore the family with the same terms and conjugates, if it is kept.
  subroutine recall(family)
    type(family_type), intent(inout) :: family
    integer :: i
    if (.not. take_lock()) return
    do i = 1, min(n_kept, most_kept)
      if (.not. kept(i)%is_of(family%system%n, family%system%row, family%system%at)) cycle
      if (any(kept(i)%mirror /= family%mirror)) cycle
      family = kept(i)
      exit
    end do
    call release_lock()
  end subroutine recall

  !> Store the family in place of the oldest.
  subroutine keep(family)
    type(family_type), intent(in) :: family
    if (.not. take_lock()) return
    n_kept = n_kept + 1
    if (n_kept > 2*most_kept) n_kept = most_kept + 1
    kept(modulo(n_kept - 1, most_kept) + 1) = family
    call release_lock()
  end subroutine keep

  !> Random coefficients; those of a term and of its conjugate are conjugates, so that solutions
  !! have the symmetries of all members of interest.
  subroutine choose_generic(self)
    class(family_type), intent(inout) :: self
    integer :: i, k, mirrored(0:self%system%n), wanted(4)

    mirrored = [0, self%mirror]
    associate (row => self%system%row, at => self%system%at)
      ! Phases in equal steps would make products of coefficients equal.
      self%generic = [(wave(0.7548776662466927_wp*i**3 + 0.1_wp) &
                       *(0.6_wp + 0.8_wp*modulo(0.5698402909980532_wp*i**2, 1.0_wp)), &
                       i=1, size(row))]
      do i = 1, size(row)
        wanted = [mirrored(row(i)), sorted(mirrored(at(:, i)))]
        do k = 1, i
          if (any([row(k), sorted(at(:, k))] /= wanted)) cycle
          self%generic(i) = conjg(self%generic(k))
          if (k == i) self%generic(i) = real(self%generic(i))
          exit
        end do
      end do
    end associate
  end subroutine choose_generic

  pure function sorted(three) result(ordered)
    integer, intent(in) :: three(3)
    integer :: ordered(3)
    ordered(1) = minval(three)
    ordered(3) = maxval(three)
    ordered(2) = sum(three) - ordered(1) - ordered(3)
  end function sorted

  !> Linear forms whose products contain all terms: of the first m unknowns (kind 1), of the others
  !! (2), of all (3), or none (0, the form 1). Forms of all unknowns add start solutions.
  subroutine find_forms(system, m, kinds, forms)
    type(polynomials_type), intent(in) :: system
    integer, intent(in) :: m
    integer, intent(out) :: kinds(:, :)
    complex(wp), intent(out) :: forms(0:, :, :)
    integer :: i, q, k, r, first, second, both, n_first, n_second, n_both

    forms = (0.0_wp, 0.0_wp)
    kinds = 0
    k = 0
    do r = 1, system%n
      n_first = 0
      n_second = 0
      n_both = 0
      do i = 1, size(system%row)
        if (system%row(i) /= r) cycle
        first = count(system%at(:, i) > 0 .and. system%at(:, i) <= m)
        second = count(system%at(:, i) > m)
        n_first = max(n_first, first)
        n_second = max(n_second, second)
        n_both = max(n_both, first + second)
      end do
      both = n_first + n_second - n_both
      kinds(:n_both, r) = [(merge(1, 0, q <= n_first - both) + merge(2, 0, q > n_first), &
                            q=1, n_both)]
      where (kinds(:n_both, r) == 0) kinds(:n_both, r) = 3
      do q = 1, 3
        forms(0, q, r) = (1.0_wp, 0.0_wp)
        if (kinds(q, r) == 0) cycle
        do i = 0, system%n
          if (i > 0 .and. i <= m .and. kinds(q, r) == 2) cycle
          if (i > m .and. kinds(q, r) == 1) cycle
          k = k + 1
          forms(i, q, r) = wave(0.6180339887498949_wp*k + 0.2236067977499790_wp*k**2)
        end do
      end do
    end do
  end subroutine find_forms

  !> exp(2 pi i turns).
  elemental complex(wp) function wave(turns)
    real(wp), intent(in) :: turns
    real(wp), parameter :: two_pi = 6.283185307179586_wp
    wave = cmplx(cos(two_pi*turns), sin(two_pi*turns), wp)
  end function wave

  pure logical function known(found, x)
    complex(wp), intent(in) :: found(:, :), x(:)
    known = place_of(found, x, 1.0e-8_wp) > 0
  end function known

  !> The index of the column equal to x; 0: none.
  pure integer function place_of(found, x, tolerance) result(i)
    complex(wp), intent(in) :: found(:, :), x(:)
    real(wp), intent(in) :: tolerance
    real(wp) :: limit
    integer :: k
    limit = tolerance*max(size_of(x), 1.0e-3_wp)
    columns: do i = 1, size(found, 2)
      do k = 1, size(x)
        if (abs(real(found(k, i) - x(k))) > limit) cycle columns
        if (abs(aimag(found(k, i) - x(k))) > limit) cycle columns
      end do
      return
    end do columns
    i = 0
  end function place_of

  pure logical function is_of(self, n, row, at)
    class(family_type), intent(in) :: self
    integer, intent(in) :: n, row(:), at(:, :)
    is_of = self%system%n == n .and. allocated(self%system%row)
    if (is_of) is_of = size(self%system%row) == size(row)
    if (is_of) is_of = all(self%system%row == row) .and. all(self%system%at == at)
  end function is_of

  !> Find the sign changes that preserve all terms; conjugate unknowns change sign together.
  subroutine find_signs(self)
    class(family_type), intent(inout) :: self
    real(wp) :: signs(0:self%system%n)
    integer :: code, i, k, n
    logical :: holds

    n = self%system%n
    allocate (self%signs(n, 0))
    do code = 0, 2**n - 1
      signs(0) = 1.0_wp
      signs(1:) = [(merge(-1.0_wp, 1.0_wp, btest(code, i - 1)), i=1, n)]
      if (any(signs(1:)*signs(self%mirror) < 0.0_wp)) cycle
      holds = .true.
      do k = 1, size(self%system%row)
        holds = holds .and. signs(self%system%row(k))*product(signs(self%system%at(:, k))) > 0.0_wp
      end do
      if (holds) self%signs = reshape([self%signs, signs(1:)], [n, size(self%signs, 2) + 1])
    end do
  end subroutine find_signs

  !> x with sign change k; above their number also conjugated.
  pure function imaged(self, x, k) result(y)
    class(family_type), intent(in) :: self
    complex(wp), intent(in) :: x(:)
    integer, intent(in) :: k
    complex(wp) :: y(size(x))
    y = self%signs(:, modulo(k - 1, size(self%signs, 2)) + 1)*x
    if (k > size(self%signs, 2)) y = conjg(y(self%mirror))
  end function imaged

  !> For each solution find the solution and the symmetry, of the first n_images, that give it.
  subroutine find_images(self, x, n_images, leader, image)
    class(family_type), intent(in) :: self
    complex(wp), intent(in) :: x(:, :)
    integer, intent(in) :: n_images
    integer, allocatable, intent(out) :: leader(:), image(:)
    integer :: i, k, other

    allocate (leader(size(x, 2)), image(size(x, 2)), source=0)
    do i = 1, size(x, 2)
      if (leader(i) > 0) cycle
      leader(i) = i
      image(i) = 1
      do k = 2, n_images
        other = place_of(x, self%imaged(x(:, i), k), 1.0e-6_wp)
        if (other == 0) cycle
        if (leader(other) > 0) cycle
        leader(other) = i
        image(other) = k
      end do
    end do
  end subroutine find_images

  !> The finite solutions for given coefficients, a conjugate pair in conjugate positions.
  subroutine solve_member(self, coefficients, unit, x, n_found, cancel)
    class(family_type), intent(inout) :: self
    complex(wp), intent(in) :: coefficients(:)
    !> Unit of the unknowns, for comparison of different members.
    real(wp), intent(in) :: unit
    !> Shape (n, at least size(solutions, 2)).
    complex(wp), intent(out) :: x(:, :)
    integer, intent(out) :: n_found
    integer, intent(inout) :: cancel
    complex(wp) :: path(self%system%n)
    complex(wp) :: ends(self%system%n, size(self%solutions, 2))
    logical :: arrived(size(self%solutions, 2)), careful, met, double
    integer :: i

    x = (0.0_wp, 0.0_wp)
    call self%solve_near(coefficients, unit, x, n_found)
    if (n_found == self%most .and. self%most > 0) return
    careful = .false.
    do
      n_found = 0
      met = .false.
      double = .false.
      do i = 1, size(self%solutions, 2)
        if (is_set(cancel)) return
        if (self%leader(i) == i) then
          path = self%solutions(:, i)
          call follow(self%system, self%generic, coefficients, far, careful, path, arrived(i))
          if (arrived(i)) call settle(path, arrived(i))
        else
          path = self%imaged(ends(:, self%leader(i)), self%image(i))
          arrived(i) = arrived(self%leader(i))
        end if
        ends(:, i) = path
        if (.not. arrived(i)) cycle
        if (known(x(:, :n_found), path)) then
          met = .true.
        else
          n_found = n_found + 1
          x(:, n_found) = path
        end if
      end do
      if (careful .or. .not. met .or. n_found >= self%most) exit
      careful = .true.
    end do
    if (allocated(self%last)) deallocate (self%last)
    if (double) return
    self%last = x(:, :n_found)
    self%last_coefficients = coefficients
    self%last_unit = unit
    self%most = max(self%most, n_found)
    call self%find_images(self%last, 2*size(self%signs, 2), self%last_leader, self%last_image)

  contains

    !> A path may only approach a double solution, or one near infinity. A double solution is
    !! accepted if it is its own conjugate, and Newton's method does not leave it.
    subroutine settle(y, found)
      complex(wp), intent(inout) :: y(:)
      logical, intent(inout) :: found
      complex(wp) :: exact(size(y))
      exact = y
      call correct(self%system, coefficients, exact, found)
      if (found) then
        y = exact
        return
      end if
      found = size_of(y - conjg(y(self%mirror))) <= 1.0e-3_wp*size_of(y)
      double = double .or. found
    end subroutine settle

  end subroutine solve_member

  !> Solutions from those of the previous member, by Newton's method or, if that does not converge,
  !! along a path; n_found = 0 if not all are found.
  subroutine solve_near(self, coefficients, unit, x, n_found)
    class(family_type), intent(inout) :: self
    complex(wp), intent(in) :: coefficients(:)
    real(wp), intent(in) :: unit
    complex(wp), intent(inout) :: x(:, :)
    integer, intent(out) :: n_found
    complex(wp) :: from(size(coefficients))
    logical :: found
    integer :: i

    n_found = 0
    if (.not. allocated(self%last)) return
    if (size(self%last, 2) < self%most) return
    from = self%last_coefficients*(unit/self%last_unit)**count(self%system%at > 0, 1)
    do i = 1, size(self%last, 2)
      if (self%last_leader(i) == i) then
        x(:, i) = self%last(:, i)*(self%last_unit/unit)
        call correct(self%system, coefficients, x(:, i), found)
        if (.not. found) then
          x(:, i) = self%last(:, i)*(self%last_unit/unit)
          call follow(self%system, from, coefficients, far, .false., x(:, i), found)
        end if
        if (.not. found) return
      else
        x(:, i) = self%imaged(x(:, self%last_leader(i)), self%last_image(i))
      end if
      if (known(x(:, :i - 1), x(:, i))) return
    end do
    n_found = size(self%last, 2)
    self%last = x(:, :n_found)
    self%last_coefficients = coefficients
    self%last_unit = unit
  end subroutine solve_near

end module viscovib_homotopy
